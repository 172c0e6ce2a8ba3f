"""Path tracing with next-event estimation: sampled paths of every order, joined to the fields of view."""
