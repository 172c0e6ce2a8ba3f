"""Benchmark sets of known bytes: `datagen suite`."""

from datagen.suites.catalogue import SUITES, Suite, find_suite, suite_of
from datagen.suites.make import SuiteResult, build_suite

__all__ = ["SUITES", "Suite", "SuiteResult", "build_suite", "find_suite", "suite_of"]
