"""Benches: what accuracy, size and detector cost, beside what others take; each is a `datagen bench` command."""
