"""The section `effects`: which effects are simulated; `datagen/effects` holds the table and the decisions."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from datagen.config.base import Settings
from datagen.records.checks import check_choice


def _as_word(value: Any) -> Any:
    """YAML reads a bare `on` or `off` as true or false."""
    return {True: "on", False: "off"}[value] if isinstance(value, bool) else value


Switch = Annotated[Literal["auto", "on", "off"], BeforeValidator(_as_word)]
"""`on`: always simulated; `off`: never; `auto`: unless leaving it out saves time and changes too little."""


class EffectsConfig(Settings):
    """What of the world that the other sections describe is simulated: `auto`, `on` or `off` for each effect.

    The other sections say what there is (bounce orders, fog, dead time …); an effect that they leave no room for
    stays absent whatever stands here. Occlusion, lobes, walls, ambient light and dark counts are always simulated.
    """

    tolerance: Annotated[float, Field(ge=0, le=1)] = 0.01
    """How much all effects left out by `auto` may change the answer together: relative L2 of the transient (of its
    light of three bounces and more), and of the expected histogram for the detector's effects. With 0 only what
    changes nothing at all is left out."""
    direct_return: Switch = "auto"
    """One and two bounces: the laser point, or a surface it lights, inside the field of view."""
    secondary_bounce: Switch = "auto"
    """Four bounces."""
    higher_bounces: Switch = "auto"
    """Five bounces and more, as far as `transport.max_bounces` goes."""
    attenuation: Switch = "auto"
    """Absorption and scattering by the air."""
    timing_response: Switch = "auto"
    """Laser pulse, carrier diffusion and jitter (the IRF)."""
    pile_up: Switch = "auto"
    """Events lost to the dead time of earlier ones in the same laser cycle. `on` here, and for the next three, asks
    for exact samplers; with `auto` the sampler may be as biased as `detector.tolerance`."""
    dead_time_across_cycles: Switch = "auto"
    """Events lost to the dead time of those in earlier cycles (mode `free_running`); left out, the detector is armed
    afresh by every laser pulse."""
    afterpulsing: Switch = "auto"
    """Avalanches set off by what earlier ones left in traps."""
    crosstalk: Switch = "auto"
    """Avalanches set off by neighbouring pixels."""
    gate: Switch = "auto"
    """The detector's sensitivity in time; left out, it is always on."""
    tdc_nonlinearity: Switch = "auto"
    """Unequal widths of the TDC's bins (`detector.tdc_dnl`, `.tdc_edges_ps`)."""
    tdc_saturation: Switch = "auto"
    """Counters that stay at `detector.counter_max`."""

    def _check(self) -> None:
        if self.dead_time_across_cycles == "on" and self.pile_up == "off":
            raise ValueError(
                "dead_time_across_cycles = 'on' with pile_up = 'off': a dead time acts in its own cycle before it "
                "reaches the next; set pile_up to 'on' or 'auto', or dead_time_across_cycles to 'auto'"
            )

    def of(self, effect: str) -> str:
        """The setting of an effect by its name in the table. A dead time across cycles that is on turns pile-up
        on."""
        check_choice("effect", effect, tuple(name for name in type(self).model_fields if name != "tolerance"))
        setting: str = getattr(self, effect)
        needed = effect == "pile_up" and setting == "auto" and self.dead_time_across_cycles == "on"
        return "on" if needed else setting
