"""Laws every BRDF obeys: sampler = pdf (χ²), reciprocity, albedo ≤ 1 at every incidence, furnace, limits, no NaN.

Directions are laid out about the axis of each lobe (mirror direction, incoming direction, or the normal), so that a
lobe of half a degree is resolved as well as a broad one. Nothing here uses a model's own frame or mapping.
"""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import get_args

import numpy as np
import pytest
from every_brdf import KINDS, LAWS
from lobe_sphere import (
    NORMAL,
    about,
    draw,
    incoming,
    integrals,
    most_along,
    row_of,
    values_along,
    widened,
)
from numpy.typing import NDArray
from scipy import stats

from datagen import GGX, Lambertian, OrenNayar, Phong, Retroreflector, SinLobe
from datagen.config.scene_brdfs import BrdfSettings
from datagen.errors import InputError
from datagen.records import Material
from datagen.transport import brdf
from datagen.transport.brdf import LAMBERTIAN, MaterialTable, albedo, ggx, lobe_width, model_of

COSINES = (1.0, 0.8, 0.3, 0.02, 1e-4)
LEVEL = 1e-3

every_kind = pytest.mark.parametrize("material", LAWS, ids=str)


@every_kind
def test_sampler_has_the_density_it_states(material: Material) -> None:
    """χ² of 40 000 draws over 12 × 12 bins laid out about the lobe, and the share that falls below the surface.

    Level 10⁻³ for the family of all models and incidences (Bonferroni)."""
    kind, values = row_of(material)
    rng = np.random.default_rng(11)
    count, level = 40_000, LEVEL / (len(LAWS) * len(COSINES))
    for cosine in COSINES:
        w_in = incoming(cosine)
        whole = integrals(material, tuple(w_in))
        w_out = draw(kind, values, NORMAL, w_in, rng.random((count, 2)))
        np.testing.assert_allclose(np.linalg.norm(w_out, axis=1), 1, atol=1e-12)
        above = w_out @ NORMAL > 0
        wanted, lost = (count * whole.mass).ravel(), count * (1 - whole.mass.sum())
        seen = whole.sphere.counts(w_out[above]).ravel()
        assert seen.sum() == above.sum()
        # Whether none or a few in a thousand are lost below the surface is more than quadrature can settle.
        assert abs(lost - (count - above.sum())) < 5 * math.sqrt(max(lost, 0)) + 2e-3 * count
        few = wanted < 10
        rest = wanted[few].sum()
        assert abs(seen[few].sum() - rest) < stats.norm.isf(level) * math.sqrt(rest) + 8
        chi2 = ((seen[~few] - wanted[~few]) ** 2 / wanted[~few]).sum()
        assert stats.chi2.sf(chi2, (~few).sum()) > level, (cosine, chi2, (~few).sum())


@every_kind
def test_reciprocity(material: Material) -> None:
    """f(a, b) = f(b, a) for random pairs, half of them close to grazing or to each other."""
    rng = np.random.default_rng(5)
    n = 20_000
    a = about(NORMAL, rng.random(n) ** np.where(np.arange(n) % 2, 1.0, 0.02), rng.random(n) * 2 * np.pi)
    b = about(NORMAL, rng.random(n), rng.random(n) * 2 * np.pi)
    near = np.arange(n) % 4 == 0
    b[near] = a[near] + 0.02 * rng.normal(size=(near.sum(), 3))
    mirrored = np.arange(n) % 4 == 1
    b[mirrored] = 2 * (a[mirrored] @ NORMAL)[:, None] * NORMAL - a[mirrored] + 0.02 * rng.normal(size=(n // 4, 3))
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    kind, values = row_of(material)
    there, _ = values_along(kind, values, NORMAL, a, b)
    back, _ = values_along(kind, values, NORMAL, b, a)
    assert (there > 0).sum() > n / 10
    np.testing.assert_allclose(there, back, rtol=1e-10, atol=0)


def stated_albedo(material: Material, w_in: NDArray[np.float64]) -> float:
    """`albedo` for light from `w_in`, with its azimuth from the projected axis."""
    cosine, azimuth = float(np.clip(w_in @ NORMAL, 0, 1)), math.pi / 2
    if isinstance(material, SinLobe):
        axis, inside = np.asarray(material.axis), w_in - cosine * NORMAL
        axis = axis - (axis @ NORMAL) * NORMAL
        lengths = float(np.linalg.norm(axis) * np.linalg.norm(inside))
        sine = float(np.linalg.norm(np.cross(axis, inside))) / lengths if lengths > 1e-9 else 2 / math.pi
        azimuth = math.asin(min(sine, 1.0))
    return float(albedo(material, cosine, azimuth))


@every_kind
def test_albedo_is_what_the_brdf_integrates_to_and_never_more_than_the_record(material: Material) -> None:
    """∫ f cosθ dω by quadrature over directions against `albedo`, from normal incidence to 10⁻⁴ of grazing."""
    for cosine in COSINES:
        w_in = incoming(cosine)
        stated, whole = stated_albedo(material, w_in), integrals(material, tuple(w_in))
        assert whole.power == pytest.approx(stated, rel=2e-3, abs=1e-4), cosine
        assert whole.power <= material.albedo * (1 + 2e-4)
        assert whole.mass.sum() <= 1 + 1e-3
    everywhere = albedo(material, np.linspace(0, 1, 301) ** 3)
    assert ((everywhere >= 0) & (everywhere <= material.albedo * (1 + 1e-9))).all()


@pytest.mark.parametrize(
    "material", [OrenNayar(0.9, 0.2), OrenNayar(1.0, 1.2), GGX(0.9, 0.1), GGX(1.0, 0.7)], ids=str
)
def test_energy_preserving_models_return_their_albedo_at_every_incidence(material: Material) -> None:
    np.testing.assert_allclose(albedo(material, np.linspace(0, 1, 101)), material.albedo, rtol=2e-4)
    for cosine in (1.0, 0.5, 0.1):
        assert integrals(material, tuple(incoming(cosine))).power == pytest.approx(material.albedo, rel=1e-3, abs=0)


@every_kind
def test_finite_everywhere_and_nothing_below_the_surface(material: Material) -> None:
    kind, values = row_of(material)
    edge = 1 - 2.0**-33
    uv = np.array([(u, v) for u in (0.0, 2.0**-33, 0.5, edge, 1.0) for v in (0.0, 0.25, 0.5, edge, 1.0)])
    for n in (np.array([0, 0, 1.0]), np.array([0, 0, -1.0]), np.array([1.0, 0, 0]), NORMAL):
        grazing = [incoming(c, a, n) for c in (0.0, 1e-300, 1e-16, 1e-9) for a in (0.0, 2.0)]
        w_in = [n, *grazing, *(incoming(c, 1.0, n) for c in COSINES)]
        out = np.array([n, -n, *grazing, *(-w for w in grazing), *w_in])
        for w in w_in:
            drawn = draw(kind, values, n, w, uv)
            assert np.isfinite(drawn).all()
            np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1, atol=1e-9)
            f, density = values_along(kind, values, n, w[None], np.concatenate([out, drawn]))
            assert np.isfinite(f).all() and np.isfinite(density).all()
            assert (f >= 0).all() and (density >= 0).all()
            assert (f[np.concatenate([out, drawn]) @ n < -1e-15] == 0).all()
        f, _ = values_along(kind, values, n, -NORMAL[None] if n is NORMAL else -n[None], out)
        assert (f == 0).all()


def directions(seed: int, n: int = 4000) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n, 3) incoming and outgoing directions, a third of the pairs near the mirror direction, a third near each
    other."""
    rng = np.random.default_rng(seed)
    a = about(NORMAL, 0.98 * rng.random(n), rng.random(n) * 2 * np.pi)
    b = about(NORMAL, 0.98 * rng.random(n), rng.random(n) * 2 * np.pi)
    near, mirrored = np.arange(n) % 3 == 0, np.arange(n) % 3 == 1
    b[near] = a[near] + 0.05 * rng.normal(size=(near.sum(), 3))
    b[mirrored] = 2 * (a[mirrored] @ NORMAL)[:, None] * NORMAL - a[mirrored]
    b[mirrored] += 0.05 * rng.normal(size=(mirrored.sum(), 3))
    return a, b / np.linalg.norm(b, axis=1, keepdims=True)


@every_kind
def test_the_largest_value_over_a_piece_of_surface(material: Material) -> None:
    """`evaluate_at_most` without any deviation is `evaluate`; with one it is no less, finite, and at least what the
    BRDF is in directions that deviate by as much, but for the cosines of lobes and the shading of a matt surface."""
    kind, values = row_of(material)
    a, b = directions(3)
    f, _ = values_along(kind, values, NORMAL, a, b)
    # Where a lobe has all but ended, rounding of its angle is all that is left.
    np.testing.assert_allclose(most_along(kind, values, NORMAL, a, b, 0.0, 0.0), f, rtol=1e-6, atol=1e-12 * f.max())
    if math.isinf(model_of(material).lobe_width_rad(material)):
        most = most_along(kind, values, NORMAL, a, b, 0.05, 0.02)
        assert np.isfinite(most).all() and (most >= f * (1 - 1e-9)).all()
        return
    turned = b + 0.02 * np.cross(b, np.random.default_rng(4).normal(size=b.shape))
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    turn = np.arccos(np.clip((turned * b).sum(axis=1), -1, 1)).max()
    # At grazing directions the cosines, which the bound takes at `b`, change by much.
    steep = (a @ NORMAL > 0.2) & (b @ NORMAL > 0.2) & (turned @ NORMAL > 0.2)
    most = most_along(kind, values, NORMAL, a[steep], b[steep], turn, 0.0)
    elsewhere, _ = values_along(kind, values, NORMAL, a[steep], turned[steep])
    assert np.isfinite(most).all()
    assert (most >= f[steep] * (1 - 1e-9) - 1e-12 * f.max()).all()
    assert (most >= 0.6 * elsewhere - 1e-12 * f.max()).all()


@every_kind
def test_a_widened_lobe_is_as_wide_as_asked_and_still_a_brdf(material: Material) -> None:
    """What has no lobe stays the same; a lobe that is wider than the angle, too."""
    kind, values = row_of(material)
    a, b = directions(5)
    before, _ = values_along(kind, values, NORMAL, a, b)
    np.testing.assert_array_equal(widened(kind, values, 1e-5), values)
    after, density = values_along(kind, widened(kind, values, 0.5), NORMAL, a, b)
    assert np.isfinite(after).all() and np.isfinite(density).all() and (after >= 0).all()
    if lobe_width(material) < 0.2:
        assert after.max() < before.max()
    if math.isinf(model_of(material).lobe_width_rad(material)):
        np.testing.assert_array_equal(after, before)


def test_every_kind_is_asked_and_an_unknown_one_fails() -> None:
    """Each kind of the table and of the configuration is a row of `every_brdf.py`, so that each function of each is
    called here, and each kind is compared in each way to light; a kind that a function does not call is an error."""
    assert {kind.record for kind in KINDS.values()} == {model.record for model in brdf.MODELS}
    assert {int(row_of(material)[0]) for material in LAWS} == set(range(len(brdf.MODELS)))
    offered = {settings.model_fields["kind"].default for settings in get_args(get_args(BrdfSettings)[0])}
    assert set(KINDS) == offered - {"catalogue"}
    for kind in KINDS.values():
        assert kind.broad, f"{kind.record.__name__} is compared in no way to light"
        assert {type(material) for material in (*kind.laws, *kind.broad.values(), *kind.matt)} == {kind.record}
    unknown, values = np.int64(len(brdf.MODELS)), row_of(Retroreflector(0.8))[1]
    w = incoming(0.8)
    for call in (
        lambda: values_along(unknown, values, NORMAL, w[None], w[None]),
        lambda: most_along(unknown, values, NORMAL, w[None], w[None], 0.1, 0.1),
        lambda: draw(unknown, values, NORMAL, w, np.full((1, 2), 0.5)),
        lambda: widened(unknown, values, 0.1),
    ):
        with pytest.raises(ValueError, match="a kind of BRDF that the table"):
            call()


def test_limits_that_are_lamberts_law() -> None:
    rng = np.random.default_rng(8)
    a = about(NORMAL, rng.random(500), rng.random(500) * 6)
    b = about(NORMAL, rng.random(500), rng.random(500) * 6)
    for material in (material for kind in KINDS.values() for material in kind.matt):
        f, density = values_along(*row_of(material), NORMAL, a, b)
        np.testing.assert_allclose(f, material.albedo / np.pi, rtol=1e-13)
        np.testing.assert_allclose(density, b @ NORMAL / np.pi, rtol=1e-12)
    assert row_of(Phong(0.4, exponent=0))[0] == LAMBERTIAN
    # Nearly Lambertian is nearly so at normal incidence, where a lobe of exponent 0 is a whole hemisphere.
    f, _ = values_along(*row_of(Phong(0.4, exponent=1e-3)), NORMAL, NORMAL[None], b[b @ NORMAL > 0.01])
    np.testing.assert_allclose(f, 0.4 / np.pi, rtol=6e-3)


def test_ggx_closed_forms() -> None:
    """α = 1 at normal incidence: single scattering returns 1 − ln 2; the nearly smooth dielectric returns f0."""
    assert ggx.single_albedo(1.0, 1.0, 1.0, ggx.unit_gauss(32)) == pytest.approx(1 - math.log(2), abs=1e-9)
    assert float(albedo(GGX(1.0, 0.1, f0=0.04), 1.0)) == pytest.approx(0.04, abs=3e-4)
    # Schlick at 80°: 0.04 + 0.96 (1 − cos 80°)⁵, before roughness blurs it.
    cosine = math.cos(math.radians(80))
    assert float(albedo(GGX(1.0, 0.1, f0=0.04), cosine)) == pytest.approx(
        0.04 + 0.96 * (1 - cosine) ** 5, rel=0.03, abs=0
    )


def test_sin_lobe_keeps_light_in_a_plane_parallel_to_the_floor() -> None:
    """From a vertical face, whatever comes in: the mean square of the horizontal part along the face is twice that of
    the vertical part, as of |sin θ|; at the incidence the same |sin θ|. On a floor no azimuth is singled out."""
    n = np.array([0.6, 0.8, 0.0])
    along, up = np.array([-0.8, 0.6, 0.0]), np.array([0.0, 0.0, 1.0])
    rng = np.random.default_rng(3)
    for azimuth in (0.1, 1.0):
        w_in = (0.5 * n + math.sqrt(0.75) * (math.cos(azimuth) * up + math.sin(azimuth) * along))[None]
        kind, values = row_of(SinLobe(0.8))
        w_out = draw(kind, values, n, w_in[0], rng.random((100_000, 2)))
        assert np.mean((w_out @ along) ** 2) / np.mean((w_out @ up) ** 2) == pytest.approx(2, rel=0.02, abs=0)
        power = integrals(SinLobe(0.8), tuple(w_in[0]), tuple(n)).power
        assert power == pytest.approx(0.8 * math.sin(azimuth), rel=2e-3, abs=0)
        expected = 0.8 * math.sin(azimuth) / 2 * np.abs(w_out @ along) / np.sqrt(1 - (w_out @ n) ** 2)
        np.testing.assert_allclose(values_along(kind, values, n, w_in, w_out)[0], expected, rtol=1e-6)
    f, _ = values_along(
        *row_of(SinLobe(0.8)), up, incoming(0.3, 1.0, up)[None], about(up, rng.random(50), rng.random(50) * 6)
    )
    np.testing.assert_allclose(f, 0.8 / 2 * (2 / np.pi) ** 2, rtol=1e-12)


@every_kind
def test_no_parameter_may_be_nan(material: Material) -> None:
    for name in (of.name for of in fields(material)):
        with pytest.raises(InputError, match=rf"^{type(material).__name__}\.{name} = nan: must be .*"):
            replace(material, **{name: math.nan})


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: Phong(1.2), "Phong.albedo = 1.2: must be a number in 0 … 1"),
        (lambda: GGX(math.nan), "GGX.albedo = nan"),
        (lambda: Phong(0.5, exponent=-1), "Phong.exponent = -1: must be a number in 0 … 10000"),
        (lambda: Phong(0.5, exponent=2e4), "Phong.exponent"),
        (lambda: Phong(0.5, 20, specular=1.1), "Phong.specular = 1.1: must be a number in 0 … 1"),
        (lambda: OrenNayar(0.5, 20), "OrenNayar.sigma_rad = 20: must be a number in 0 … 1.5708 (radians"),
        (lambda: GGX(0.5, roughness=0.01), "GGX.roughness = 0.01: must be a number in 0.1 … 1"),
        (lambda: GGX(0.5, f0=-0.1), "GGX.f0"),
        (lambda: Retroreflector(0.5, half_width_rad=0), "Retroreflector.half_width_rad = 0: must be a number"),
        (lambda: Retroreflector(0.5, retro=2), "Retroreflector.retro = 2"),
        (lambda: SinLobe(0.5, axis=(0, 0, 0)), "SinLobe.axis = (0, 0, 0): must be three finite numbers"),
        (lambda: SinLobe(0.5, axis="up"), "SinLobe.axis = 'up'"),  # type: ignore[arg-type]
        (lambda: Lambertian("white"), "Lambertian.albedo = 'white'"),  # type: ignore[arg-type]
        (lambda: albedo(Phong(0.5), 1.5), "cos_in = 1.5"),
        (lambda: MaterialTable.of((Material(0.5),)), "material Material: the transport knows Lambertian, SinLobe"),
    ],
)
def test_bad_parameters_are_named_in_one_line(build, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError) as caught:
        build()
    assert words in str(caught.value) and "\n" not in str(caught.value)
