"""Benchmark datasets, of which the first scenes are published: `datagen suite`.

`catalogue` names them and imports no more than configurations, so that a list of them takes no time; `building` and
`published` make them and know them again.
"""
