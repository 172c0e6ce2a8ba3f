"""Classes of objects made by code: each draws its own proportions and returns a `Solid` of natural size."""

from scene_library.objects.classes import CLASSES, GROUPS, build, classes_of

__all__ = ["CLASSES", "GROUPS", "build", "classes_of"]
