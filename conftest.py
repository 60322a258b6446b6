"""What pytest needs wherever it starts.

The Python blocks of README.md and docs/ are tests of their own; a run that is terminated ends its servers.
"""

from tests.docs.python_blocks import sybil
from tests.docs.scratch import docs_scratch
from tests.docs.tiny_api import tiny_api
from tests.ending import pytest_configure

__all__ = ["docs_scratch", "pytest_collect_file", "pytest_configure", "tiny_api"]

pytest_collect_file = sybil().pytest()
