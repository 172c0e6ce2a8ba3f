"""A measurement designed so that its objects are seen: the exposure, and where objects may stand."""
