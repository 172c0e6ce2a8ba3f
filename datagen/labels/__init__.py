"""Ground truth beside the measurement: images seen from the relay wall, volumes of the hidden part, object boxes.

If the relay wall were a window, what would stand behind it? All labels share one right-handed frame, that of
`Scene.hidden_view`: `right` and `up` lie in the plane of the relay wall, and the third axis, `depth`, is the wall's
normal right × up, which points from the wall into the room. See `datagen.labels.frame`.
"""

from datagen.labels.boxes import OBJECT_TABLES, ObjectBoxes
from datagen.labels.frame import ViewFrame
from datagen.labels.make import IMAGE_FIELDS, LABEL_FIELDS, VOLUME_FIELDS, ObjectSlots, make_labels

__all__ = [
    "IMAGE_FIELDS",
    "LABEL_FIELDS",
    "OBJECT_TABLES",
    "VOLUME_FIELDS",
    "ObjectBoxes",
    "ObjectSlots",
    "ViewFrame",
    "make_labels",
]
