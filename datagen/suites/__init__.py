"""Benchmark datasets whose bytes are published: `datagen suite`."""

from datagen.suites.catalogue import SUITES, Suite, SuiteResult, build_suite, find_suite, suite_of

__all__ = ["SUITES", "Suite", "SuiteResult", "build_suite", "find_suite", "suite_of"]
