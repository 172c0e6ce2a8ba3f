"""Path tracing with next-event estimation: sampled paths of every order, connected with the fields of view."""
