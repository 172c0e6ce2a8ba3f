"""The section `scene`: layout, contents and materials of the rooms, as distributions to draw from."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field

from datagen.config.base import Settings
from datagen.config.distributions import Distribution, largest_count, within
from datagen.config.scene_contents import Box, Content, Mesh, MeshFolder, Pillar
from datagen.config.scene_layouts import AnyLayout, GivenScenes, ImportedCaptures, LCorridor
from datagen.config.scene_materials import Materials
from datagen.errors import InputError
from scene_library.materials import checked_wavelength_nm


class SceneConfig(Settings):
    """Random rooms: every dimension, pose and albedo is drawn from the distribution declared here."""

    layout: AnyLayout = LCorridor()
    contents: Annotated[tuple[Content, ...], Field(max_length=100)] = (Pillar(), Box())
    """The objects in the hidden part."""
    materials: Materials = Materials()
    wavelength_nm: Annotated[
        float, AfterValidator(checked_wavelength_nm), Field(json_schema_extra={"minimum": 532, "maximum": 1550})
    ] = 532.0
    """The laser's wavelength, which decides the albedo of materials taken from the catalogue. The catalogue has
    values at 532, 670, 850, 905, 940, 1064 and 1550 nm and is linear between them. With `capture.device` it is the
    device's."""
    attenuation_per_m: Annotated[Distribution, within(0)] = 0.0
    """Napierian attenuation of the air: a leg of R metres passes exp(−a R). A visibility of 1 km is 0.004."""
    clearance_m: Annotated[float, Field(ge=0.001, le=10)] = 0.02
    """Smallest gap between objects, from an object to a wall, and to the device's line of sight."""
    minimum_seen: Annotated[float, Field(ge=0, lt=1)] = 0.02
    """Every object is seen from the visible part of the relay wall along more than this share of the straight lines
    between the two surfaces (a closed object turns half of itself away, so it stays below about 0.5)."""
    max_attempts: Annotated[int, Field(ge=1, le=100_000)] = 200
    """Tries for one scene until every constraint is met; then the scene is given up with the reason. A try places the
    objects of a drawn room anew; the room itself (dimensions, number of objects, their classes, sizes and materials)
    is only drawn again when an eighth of the tries have failed with it, the next after half of that, and so on."""

    @property
    def asks_for_evidence(self) -> bool:
        """Whether a scene is accepted only if its light has enough evidence of an object (`evidence_at_least`)."""
        return any(item.evidence_at_least is not None for item in self.contents)

    def object_classes(self) -> tuple[str, ...]:
        """The classes of all objects that can be drawn, sorted: what the numbers in the label `objects` stand for."""
        if isinstance(self.layout, GivenScenes | ImportedCaptures):
            return self.layout.classes
        return tuple(sorted({name for item in self.contents for name in item.class_names}))

    def most_objects(self) -> int:
        """The largest number of objects that a scene can hold, or 1: the rows of the label `objects`."""
        if isinstance(self.layout, GivenScenes | ImportedCaptures):
            return self.layout.most_objects
        return max(1, sum(largest_count(item.count) for item in self.contents))

    def mesh_digests(self) -> dict[str, str]:
        """SHA-256 of every mesh file named: path as written → hex digest of the file's bytes."""
        digests: dict[str, str] = {}
        for i, item in enumerate(self.contents):
            if isinstance(item, (Mesh, MeshFolder)) and item.path not in digests:
                try:
                    digests[item.path] = item.digest()
                except OSError as error:
                    raise InputError(
                        f"scene.contents[{i}].path = {item.path!r}: cannot be read "
                        f"({error.strerror or error}); the file must stay where the configuration says"
                    ) from None
        return digests
