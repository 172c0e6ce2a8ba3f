"""Benchmark datasets, of which the first scenes are published: `datagen suite`."""

from datagen.suites.catalogue import SUITES, Suite, SuiteResult, build_suite, find_suite, is_published, suite_of

__all__ = ["SUITES", "Suite", "SuiteResult", "build_suite", "find_suite", "is_published", "suite_of"]
