"""A table as Parquet is written in pieces, whatever its size, and loses nothing at their joints."""

import tracemalloc

import numpy as np
import pytest

from clsim.output.result_files import write_table
from clsim.paths.path_table import PathTable

WALLS = ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")


def large_table(rng: np.random.Generator, paths: int, times: int, order: int) -> PathTable:
    delay = rng.random((paths, times))
    delay[3, 5:9] = np.nan
    return PathTable(
        times=np.arange(times) / 100.0,
        source=rng.integers(0, 2, paths, dtype=np.int32),
        receiver=rng.integers(0, 3, paths, dtype=np.int32),
        order=np.full(paths, order, dtype=np.int32),
        interactions=np.zeros((paths, order), dtype=np.int8),
        objects=rng.integers(0, 6, (paths, order), dtype=np.int8),
        direct=np.zeros(paths, dtype=np.bool_),
        delay=delay,
        doppler_factor=rng.random((paths, times)),
        doppler_shift=rng.random((paths, times)),
        gain=rng.random((paths, times)),
        departure=rng.random((paths, times, 3)),
        arrival=rng.random((paths, times, 3)),
        source_names=("robot", "beacon"),
        receiver_names=("a", "b", "the one with the long name"),
        object_names=WALLS,
    )


def test_parquet_is_written_in_pieces(tmp_path, rng: np.random.Generator) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    table = large_table(rng, paths=301, times=1000, order=30)
    write_table(
        large_table(rng, paths=9, times=9, order=2), tmp_path / "first.parquet"
    )  # loads pyarrow and its friends
    tracemalloc.start()
    try:
        write_table(table, tmp_path / "t.parquet")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # 100 000 rows of 16 columns, 8 bytes each, and a copy of one: 14 MB. Walls as text of four bytes a character,
    # all rows at once, would be 200 MB.
    assert peak < 30e6
    groups = parquet.ParquetFile(tmp_path / "t.parquet").metadata
    assert max(groups.row_group(i).num_rows for i in range(groups.num_row_groups)) <= 100_000


def test_parquet_pieces_join_without_a_seam(tmp_path, rng: np.random.Generator) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    table = large_table(rng, paths=301, times=1000, order=3)
    write_table(table, tmp_path / "t.parquet")
    read = parquet.read_table(tmp_path / "t.parquet")
    heard = np.isfinite(table.delay)
    assert read.num_rows == heard.sum() == 301_000 - 4
    path, time = np.nonzero(heard)
    np.testing.assert_array_equal(read["path"].to_numpy(), path)
    np.testing.assert_array_equal(read["times"].to_numpy(), table.times[time])
    np.testing.assert_array_equal(read["delay"].to_numpy(), table.delay[heard])
    np.testing.assert_array_equal(read["departure_y"].to_numpy(), table.departure[heard][:, 1])
    for name, names, index in (
        ("source", table.source_names, table.source),
        ("receiver", table.receiver_names, table.receiver),
    ):
        assert read[name].to_pylist() == [names[i] for i in index[path]]
    ways = [",".join(WALLS[w] for w in row) for row in table.objects]
    assert read["objects"].to_pylist() == [ways[p] for p in path]
    assert set(read["interactions"].to_pylist()) == {"0,0,0"}
