"""Pictures and pages: scenes and datasets shown to people."""
