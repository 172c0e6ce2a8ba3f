"""The ground truth of a scene: images seen from the relay wall, volumes of the hidden part, boxes of objects.

Images show the room as if the relay wall were a window. All labels share one right-handed frame, that of
`Scene.hidden_view`: `right` and `up` lie in the plane of the relay wall, and the third axis, `depth`, is the wall's
normal right × up, which points from the wall into the room. See `datagen.labels.frame`.
"""

from datagen.labels.boxes import OBJECT_TABLES, ObjectBoxes
from datagen.labels.frame import ViewFrame
from datagen.labels.make import LABEL_MAKERS, Truth, make_labels

__all__ = ["LABEL_MAKERS", "OBJECT_TABLES", "ObjectBoxes", "Truth", "ViewFrame", "make_labels"]
