"""What a build would take, before it is begun: pilot scenes, times scenes."""
