"""The cache of compiled kernels, when processes run side by side."""

import time
from concurrent.futures import ThreadPoolExecutor

from numba.core import caching

import golden

WRITERS = 6


def test_nobody_gets_what_another_has_compiled(tmp_path, monkeypatch):
    """Each adds a signature of the same kernel, having read the index before the others have written theirs."""
    read = caching.IndexDataCacheFile._load_index

    def read_early(self):
        index = read(self)
        time.sleep(0.02)
        return index

    def add(number):
        caching.IndexDataCacheFile(str(tmp_path), "kernel", "stamp").save(("signature", number), f"code {number}")

    monkeypatch.setattr(caching.IndexDataCacheFile, "_load_index", read_early)
    with ThreadPoolExecutor(WRITERS) as pool:
        list(pool.map(add, range(WRITERS)))
    cache = caching.IndexDataCacheFile(str(tmp_path), "kernel", "stamp")
    assert [cache.load(("signature", n)) for n in range(WRITERS)] == [f"code {n}" for n in range(WRITERS)]


def test_every_state_of_the_sources_has_a_folder_of_its_own(tmp_path, monkeypatch):
    for folder in ("golden", "spec"):
        (tmp_path / folder).mkdir()
    monkeypatch.setattr(golden, "_ROOT", tmp_path)
    found = {golden.kernel_folder("numba", golden._sources())}
    for folder, text in (("golden", "a = 1"), ("golden", "a = 2"), ("spec", "b = 1")):
        (tmp_path / folder / "kernel.py").write_text(text)
        found.add(golden.kernel_folder("numba", golden._sources()))
    assert len(found) == 4
