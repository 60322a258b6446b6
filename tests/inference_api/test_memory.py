import asyncio
import re
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

from inference_api.process import few_arenas, trimmed

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc and /proc")


def anonymous_mib() -> float:
    found = re.search(r"RssAnon:\s+(\d+)", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) / 1024


def test_the_c_library_takes_the_bounds() -> None:
    assert few_arenas()


def rise_and_rest() -> tuple[float, float, float]:
    """Anonymous memory in MiB before, at most, and after pieces were freed between others that stay."""

    async def fragmented() -> tuple[float, float, float]:
        async with trimmed(every_s=0.01):
            before = anonymous_mib()
            pieces = [bytes([1]) * (64 * 1024) for _ in range(1600)]
            # What stays keeps the ends of the arena in use.
            stays = pieces[::32]
            most = anonymous_mib()
            del pieces
            end = asyncio.get_running_loop().time() + 5.0
            while anonymous_mib() > before + 50 and asyncio.get_running_loop().time() < end:
                await asyncio.sleep(0.01)
            assert len(stays) == 50
            return before, most, anonymous_mib()

    return asyncio.run(fragmented())


def test_what_was_freed_between_pieces_in_use_goes_back_to_the_system() -> None:
    # A process of its own: this one may hold free memory from other tests.
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        before, most, afterwards = pool.submit(rise_and_rest).result()
    assert most > before + 90
    assert afterwards < before + 50
