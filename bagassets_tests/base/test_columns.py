"""Columns of Arrow tables are what pyarrow makes of the same values, without pandas."""

import subprocess
import sys

import numpy as np
import pyarrow as pa
import pytest

from bagassets.base.columns import column, numbers, table_of_rows

VALUES = [
    ([2**40, -1], pa.int64()),
    ([], pa.int32()),
    (np.arange(6)[::2] * 1.5, pa.float64()),
    (["a", "é", ""], pa.string()),
    ([], pa.string()),
    ([["a", "bc"], [], ["d"]], pa.list_(pa.string())),
    ([b"x", memoryview(b"yz")], pa.binary()),
]


@pytest.mark.parametrize(("values", "kind"), VALUES)
def test_a_column_is_that_of_pyarrow(values, kind):
    made = column(values, kind)
    made.validate(full=True)
    plain = [bytes(one) for one in values] if kind == pa.binary() else values
    assert made.equals(pa.array(plain, kind))


def test_numbers_of_several_chunks_none_and_a_slice():
    whole = pa.chunked_array([[1, 2], [], [3]], pa.int64())
    assert numbers(whole).tolist() == [1, 2, 3]
    assert numbers(whole.slice(1)).tolist() == [2, 3]
    assert numbers(pa.chunked_array([pa.array([1.5, 2.5, 3.5]).slice(1)])).tolist() == [2.5, 3.5]
    empty = numbers(pa.chunked_array([], pa.int32()))
    assert (empty.tolist(), empty.dtype) == ([], np.int32)


def test_a_row_without_a_value_is_refused():
    with pytest.raises(KeyError):
        table_of_rows([{"a": 1}, {}], pa.schema({"a": pa.int64()}))


def test_pandas_stays_out(tmp_path):
    (tmp_path / "pandas.py").write_text("raise SystemExit('pandas was imported')")
    code = (
        "import pyarrow as pa; from bagassets.base.columns import numbers, table_of_rows\n"
        "table = table_of_rows([{'a': 1, 's': 'x'}], pa.schema({'a': pa.int64(), 's': pa.string()}))\n"
        "assert numbers(table.column('a')).tolist() == [1]\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    loud = [sys.executable, "-c", "import pyarrow as pa; pa.array([1])"]
    done = subprocess.run(
        loud, env={"PYTHONPATH": str(tmp_path)}, capture_output=True, text=True, check=False
    )
    assert "pandas was imported" in done.stderr  # else nothing is gained any more
