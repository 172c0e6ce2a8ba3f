"""The whole configuration of a dataset: YAML ↔ frozen models, fingerprint, JSON Schema."""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer

from datagen.config.base import Settings, from_plain, without_unset
from datagen.config.capture import CaptureConfig, TimeConfig
from datagen.config.capture_motion import GivenPlaces
from datagen.config.detector import USUAL_REPETITION_RATE_HZ, DetectorConfig
from datagen.config.distributions import support
from datagen.config.effects import EffectsConfig
from datagen.config.labels import LabelsConfig
from datagen.config.scans import GridScan
from datagen.config.scene import SceneConfig
from datagen.config.scene_layouts import GivenScenes, NoLayout
from datagen.config.sequence import SequenceConfig
from datagen.config.splits import SplitsConfig
from datagen.config.store import StoreConfig
from datagen.config.transport import TransportConfig
from datagen.config.yaml_text import read_yaml
from datagen.errors import InputError
from datagen.records import Clock
from datagen.records.checks import as_given, check_path
from datagen.records.clock import Order
from scene_library.materials import checked_wavelength_nm

MOST_SCENES = 100_000_000
WITHOUT_EFFECT = ("name", "description", "license", "scenes", "splits")
"""Settings that no sample depends on: a build that is resumed may change them."""


class DatasetConfig(Settings):
    """One dataset: how many scenes, from which seed, and each stage's settings."""

    schema_version: Literal[1] = 1
    name: Annotated[str, Field(min_length=1, max_length=100)] = "unnamed"
    """A short name for cards and pictures."""
    description: str = ""
    """What the dataset is for; stands on its card."""
    license: Annotated[str, Field(max_length=200)] = ""
    """What others may do with the dataset: a name of the SPDX list such as CC-BY-4.0, or an address; stands on its
    cards."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """The dataset seed: together with a scene's index it fixes everything about that scene."""
    scenes: Annotated[int, Field(ge=1, le=MOST_SCENES)] = 32
    """How many scenes."""
    scene: SceneConfig = SceneConfig()
    capture: CaptureConfig = CaptureConfig()
    transport: TransportConfig = TransportConfig()
    detector: DetectorConfig = DetectorConfig()
    effects: EffectsConfig = EffectsConfig()
    labels: LabelsConfig = LabelsConfig()
    store: StoreConfig = StoreConfig()
    splits: SplitsConfig = SplitsConfig()
    sequence: SequenceConfig | None = None
    """Each scene is a sequence of frames, in which objects with a `motion` move. Left out: scenes stand, and are
    measured once."""

    @model_serializer(mode="wrap")
    def _plain(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_unset(self, plain, "sequence")

    @field_validator("license")
    @classmethod
    def _known_license(cls, text: str) -> str:
        """The name as the SPDX list writes it, or an address as it is."""
        if not text or re.fullmatch(r"https?://[^\s/]+\.[^\s]+", text):
            return text
        from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression

        with contextlib.suppress(InvalidLicenseExpression):
            name = canonicalize_license_expression(text)
            # Terms of one's own and combinations have no page in the list.
            if re.fullmatch(r"[A-Za-z0-9.-]+", name) and not name.startswith("LicenseRef-"):
                return name
        raise ValueError(
            "must be a name of the SPDX list (https://spdx.org/licenses) such as CC-BY-4.0, or an address (https://…)"
        )

    def _fill_from_device(self) -> None:
        """Fill in what a device says about detector, wavelength and light, as far as it is not given."""
        device = self.capture.device
        if device is None:
            return
        if "wavelength_nm" not in self.scene.model_fields_set:
            wavelength = checked_wavelength_nm(device.wavelength_nm)
            self._fill("scene", self.scene.model_copy(update={"wavelength_nm": wavelength}))
        elif self.scene.wavelength_nm != device.wavelength_nm:
            raise ValueError(
                f"scene.wavelength_nm = {self.scene.wavelength_nm:g} beside capture.device: the light of "
                f"{device.name} has {device.wavelength_nm:g} nm; leave it out"
            )
        # The relay wall's first return would blind a scanning laboratory's detector, so that has to be asked for.
        if device.is_flood and "direct" not in self.transport.model_fields_set:
            self._fill("transport", self.transport.model_copy(update={"direct": True}))
        self._fill("detector", self.detector.of_device(device))

    def _fill(self, section: str, settings: Settings) -> None:
        object.__setattr__(self, section, settings)

    def _check(self) -> None:
        self._fill_from_device()
        bins, merged = self.capture.time.bins, self.detector.bins_merged
        if bins % merged:
            raise ValueError(
                f"detector.bins_merged = {merged} with capture.time.bins = {bins}: the bins must be a multiple "
                f"of it; take {max(bins // merged, 1) * merged} bins"
            )
        if self.detector.repetition_rate_mhz is not None:
            slowest, fastest = support(self.detector.repetition_rate_mhz)
            if beyond := self.capture.time.axis().beyond_period(fastest * 1e6):
                drawn = f"{fastest:g}" if slowest == fastest else f"{slowest:g} … {fastest:g}"
                raise ValueError(f"detector.repetition_rate_mhz = {drawn} with capture.time: {beyond}")
        if any(rule.classes for rule in self.splits.held_out):
            self.splits.check_classes(self.scene.object_classes())
        self._check_sequence()

    def _check_sequence(self) -> None:
        goals = ("exposure_for", self.detector.exposure_for), ("found_for", self.detector.found_for)
        for key, goal in goals:
            if goal is None or goal.change is None:
                continue
            if self.sequence is None or not any(item.motion is not None for item in self.scene.contents):
                raise ValueError(
                    f"detector.{key}.change: nothing changes without sequence and a motion of one of scene.contents; "
                    "give both, or ask for evidence"
                )
        self._check_motion_of_sensor()
        if "moving_transient" in self.store.fields and (self.sequence is None or self.capture.motion is not None):
            why = (
                "without sequence: nothing moves"
                if self.sequence is None
                else "with capture.motion: all light changes"
            )
            raise ValueError(f"store.fields: 'moving_transient' {why}; leave the field out")
        if self.sequence is None:
            for i, item in enumerate(self.scene.contents):
                if item.motion is not None:
                    raise ValueError(
                        f"scene.contents[{i}].motion without sequence, which says how many frames there are and "
                        "when: give sequence, such as {frames: 16, rate_hz: 10}, or leave motion out"
                    )
            return
        scan, order = self.capture.scan, self.sequence.order
        # Of scenes that are given, the clock comes with them and knows the rows.
        is_given = isinstance(self.scene.layout, NoLayout)
        if order in ("serpentine", "interleaved") and not isinstance(scan, GridScan) and not is_given:
            raise ValueError(
                f"sequence.order = {order!r} with capture.scan.kind = {scan.kind!r}, which has no rows: take raster, "
                "or a grid"
            )
        self._check_exposures(self.sequence)

    def _check_motion_of_sensor(self) -> None:
        if self.capture.motion is None:
            return
        if self.sequence is None:
            raise ValueError(
                "capture.motion without sequence, which says how many frames there are and when: give sequence, such "
                "as {frames: 16, rate_hz: 10}, or leave motion out"
            )
        is_given = isinstance(self.capture.motion, GivenPlaces)
        if is_given and not isinstance(self.scene.layout, GivenScenes):
            raise ValueError(
                "capture.motion.kind = 'given': build_from writes it, for captures made in Python; take hand, drive "
                "or points"
            )
        if isinstance(self.scene.layout, NoLayout) and not is_given:
            raise ValueError(
                f"capture.motion with scene.layout.kind = {self.scene.layout.kind!r}: captures of such scenes are "
                "given, not drawn; leave motion out"
            )

    def _check_exposures(self, sequence: SequenceConfig) -> None:
        """Raise `ValueError` if the longest exposures of all laser points do not fit into a frame. Where the
        exposure, or the rate of pulses, is only drawn or found later, that is checked then."""
        own, axis = self.detector.repetition_rate_mhz, self.capture.time.axis()
        if self.detector.exposure_for is not None or (own is None and self.detector.detector_class is not None):
            return
        usual = min(USUAL_REPETITION_RATE_HZ, 1.0 / (axis.bins * axis.width_s))
        rate_hz = usual if own is None else support(own)[0] * 1e6
        try:
            # Of the order only this matters for how long they take.
            order: Order = "together" if sequence.order == "together" else "raster"
            Clock(1, sequence.rate_hz, order).times(
                self.capture.shape[0], support(self.detector.cycles)[1] / rate_hz, rate_hz
            )
        except InputError as error:
            message = str(error).replace("Clock.", "sequence.").replace(" fits for each", " of detector.cycles fit")
            raise ValueError(message) from None

    @property
    def _scan_columns(self) -> int | None:
        """Laser points in a row of the scan; None for a flood, whose points are measured as one, and for others
        without rows."""
        scan = self.capture.scan
        return scan.columns if isinstance(scan, GridScan) and self.capture.illumination == "scan" else None

    @property
    def clock(self) -> Clock | None:
        """When frames and laser points are measured; None without `sequence`."""
        of = self.sequence
        return None if of is None else Clock(of.frames, of.rate_hz, of.order, self._scan_columns)

    @property
    def histogram_shape(self) -> tuple[int, int, int]:
        """(laser, pixel, bin) of every histogram: as of a transient, with `detector.bins_merged` bins as one."""
        lasers, pixels, bins = self.capture.shape
        return lasers, pixels, bins // self.detector.bins_merged

    def fingerprint(self) -> str:
        """Hex SHA-256 of everything that decides the samples' content: all settings but those `WITHOUT_EFFECT` (a
        dataset may grow), and the bytes of every mesh file named.
        """
        return fingerprint_of(self.model_dump(mode="json"), self.scene.mesh_digests())

    def with_scenes(self, scenes: int) -> DatasetConfig:
        """The same dataset with another number of scenes (same seed, same first scenes)."""
        if not isinstance(scenes, int) or isinstance(scenes, bool) or not 1 <= scenes <= MOST_SCENES:
            raise InputError(f"{as_given('scenes', scenes)}: must be ≥ 1 and ≤ {MOST_SCENES}")
        return self.model_copy(update={"scenes": scenes})


def time_axes(config: DatasetConfig) -> dict[str, TimeConfig]:
    """Axis of the stored arrays → its bins: `bin`, and `transient_bin` where the sensor merges bins."""
    fine, merged = config.capture.time, config.detector.bins_merged
    return {"bin": fine} if merged == 1 else {"bin": fine.merged(merged), "transient_bin": fine}


def stored_axes(config: DatasetConfig) -> dict[str, TimeConfig | SequenceConfig]:
    """Axis of the stored arrays that has a coordinate → what says where its points lie: `time_axes`, and `frame` of
    sequences."""
    return {**time_axes(config), **({} if config.sequence is None else {"frame": config.sequence})}


def fingerprint_of(settings: dict[str, Any], mesh_digests: dict[str, str]) -> str:
    """The fingerprint of a configuration given as plain values, as a dataset stores its own."""
    kept = {key: value for key, value in settings.items() if key not in WITHOUT_EFFECT}
    text = json.dumps(kept | {"mesh_digests": mesh_digests}, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()


def load_config(path: str | Path) -> DatasetConfig:
    """Read a YAML file. Mesh files are named relative to it.

    Raises `InputError`, one line, for a missing file, broken YAML, an unknown key or a value that is not allowed.

    >>> import datagen as dg
    >>> config = dg.load_config("configs/quickstart.yaml")
    >>> config.scene.layout.kind, config.capture.shape
    ('l_corridor', (256, 1, 512))
    """
    check_path("path", path, "name a YAML file")
    path = Path(path)
    values = read_yaml(path, "name a configuration such as configs/quickstart.yaml")
    return config_from_mapping(values, source=str(path), base_directory=path.parent)


def config_from_mapping(
    values: dict[str, Any], source: str = "configuration", base_directory: str | Path = ".",
    look_for_files: bool = True,
) -> DatasetConfig:  # fmt: skip
    """The configuration that plain values describe. `base_directory` is the folder in which relative mesh paths
    start; `look_for_files` : refuse mesh files that are not there."""
    return from_plain(DatasetConfig, values, source, base_directory, look_for_files=look_for_files)


def json_schema() -> dict[str, Any]:
    """JSON Schema of the configuration file, for editors."""
    schema = DatasetConfig.model_json_schema(mode="validation")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
