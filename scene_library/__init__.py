"""Rooms, objects, materials and meshes as plain geometry; knows nothing of configuration, light or datasets."""
