"""What pytest needs wherever it starts: the Python blocks of README.md and docs/ are tests of their own."""

from tests.docs.python_blocks import sybil
from tests.docs.scratch import docs_scratch
from tests.docs.tiny_api import tiny_api

__all__ = ["docs_scratch", "pytest_collect_file", "tiny_api"]

pytest_collect_file = sybil().pytest()
