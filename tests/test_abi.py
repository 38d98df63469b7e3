"""What crosses from Python to the kernels by its address is what was given."""

from __future__ import annotations

import math
from collections import namedtuple

import numba
import numpy as np
import pytest
from numba import types

from adaptrack.controllers import Limits, published_mpc
from adaptrack.kernels.abi import INTERPRETED, ROUTINE, address_of, cache_base, caller, float64, int64, matrix, vector
from adaptrack.kernels.controllers import mpc as kernel
from adaptrack.kernels.stored import Resident, reader
from adaptrack.vehicle import load_vehicle

pytestmark = pytest.mark.kernels

UNCACHED = {**ROUTINE, "cache": False}


# -- records ----------------------------------------------------------------------------------------------------------
def leaves(record, path="source"):
    """(path, array) of every array of a nested record."""
    for name, value in zip(record._fields, record, strict=True):
        here = f"{path}.{name}"
        yield from leaves(value, here) if isinstance(value, tuple) else [(here, value)]


def copier(record):
    """A kernel that copies a record entry by entry into another, and every array's shape into the rows of `shapes`."""
    lines = ["def copy(source, target, shapes):"]
    for k, (path, array) in enumerate(leaves(record)):
        lines += [f"    for i in range({path}.size):"]
        lines += [f"        {path.replace('source', 'target')}.flat[i] = {path}.flat[i]"]
        lines += [f"    shapes[{k}, {axis}] = {path}.shape[{axis}]" for axis in range(array.ndim)]
    scope = {}
    exec("\n".join(lines), scope)
    return numba.njit(**UNCACHED)(scope["copy"])


def batch():
    """MPCs of three slots, every number of theirs another one."""
    mpc = published_mpc(load_vehicle("paper"), limits=Limits(output=(-3.0, 3.0)), solver="hildreth", longest_horizon=60)
    record, count = mpc.batch(3, mpc.settings()), 1
    for _, array in leaves(record):
        for name in array.dtype.names or (None,):
            column = array if name is None else array[name]
            column[...] = np.arange(count, count + column.size).reshape(column.shape)
            count += column.size
    return record


def empty_like(record):
    """A record of the same arrays, all zero."""
    return type(record)(*(empty_like(each) if isinstance(each, tuple) else np.zeros_like(each) for each in record))


@pytest.mark.slow
@pytest.mark.compiled
def test_a_record_read_by_its_address_is_the_one_that_was_given_entry_by_entry():
    record = batch()
    arrays = dict(leaves(record))
    assert {array.ndim for array in arrays.values()} == {1, 2, 3, 4}
    assert {array.dtype.kind for array in arrays.values()} == {"f", "i", "V"}
    assert any(not array.size for array in arrays.values())
    copy, read = copier(record), reader(kernel.MPCS)
    by_address = numba.njit(**UNCACHED)(lambda address, target, shapes: copy(read(address), target, shapes))
    shapes = np.zeros((2, len(arrays), 4), np.int64)
    found, given = empty_like(record), empty_like(record)
    resident = Resident(record)
    by_address(resident.address, found, shapes[0])
    copy(record, given, shapes[1])
    np.testing.assert_array_equal(shapes[0], shapes[1])
    for (path, array), row, (_, one), (_, other) in zip(
        arrays.items(), shapes[0], leaves(found), leaves(given), strict=True
    ):
        assert tuple(row[: array.ndim]) == array.shape, path
        assert one.tobytes() == other.tobytes() == array.tobytes(), path


@pytest.mark.slow
def test_what_a_kernel_writes_to_a_record_at_an_address_is_seen_in_the_record():
    record = batch()
    resident, read = Resident(record), reader(kernel.MPCS)

    @numba.njit(**UNCACHED)
    def write(address):
        mpc = read(address)
        mpc.answer[1, 2] = 0.5
        mpc.memory[2].command = 0.25

    write(resident.address)
    assert (record.answer[1, 2], record.memory[2].command) == (0.5, 0.25)


Inner = namedtuple("Inner", ("table", "count"))
Outer = namedtuple("Outer", ("before", "inner", "after"))
INNER = types.NamedTuple((matrix, int64), Inner)
OUTER = types.NamedTuple((vector, INNER, int64), Outer)


@pytest.mark.slow
def test_a_record_within_a_stored_one_is_passed_on_whole_or_by_its_place():
    outer = Outer(np.arange(3.0), Inner(np.arange(6.0).reshape(2, 3), 7), 9)
    read = reader(OUTER)

    @numba.njit(types.float64(INNER), **UNCACHED)
    def whole(inner):
        return inner.table[1, 2] + 10.0 * inner.count + 100.0 * inner.table.shape[1] + inner.table.strides[0]

    @numba.njit(**UNCACHED)
    def both(address):
        inner = read(address).inner
        return whole(inner), inner.table[0, 1] + inner.count, read(address).after, read(address).before[2]

    assert both(Resident(outer).address) == (5.0 + 70.0 + 300.0 + 24.0, 8.0, 9, 2.0)


@pytest.mark.slow
@pytest.mark.compiled
def test_a_field_that_a_stored_record_cannot_hold_or_does_not_have_is_refused():
    refused = types.NamedTuple((float64, vector), namedtuple("Refused", ("number", "others")))
    for kind, field, said in ((refused, "others", "whole numbers"), (OUTER, "behind", "behind")):
        read = reader(kind)
        scope = {"read": read}
        exec(f"def look(address):\n    return read(address).{field}.size", scope)
        with pytest.raises((TypeError, numba.TypingError), match=said):
            numba.njit(**UNCACHED)(scope["look"])(0)


# -- functions --------------------------------------------------------------------------------------------------------
MEAN = types.float64(float64, vector)
call_mean = caller(MEAN)


def mean(first, others):
    return (first + others.sum()) / (1.0 + others.size)


def doubtful(first, others):
    if first < 0.0:
        raise ValueError("negative")
    return math.sqrt(first)


@pytest.fixture(params=[UNCACHED, {}], ids=["kernel", "plain"])
def by_address(request):
    """A function that calls the one at an address, compiled as kernels are or as numba does by itself."""
    return numba.njit(**request.param)(lambda address, first, others: call_mean(address, first, others) + 1.0)


def test_a_function_called_by_its_address_gives_what_it_gives(by_address, rng):
    compiled = numba.njit(MEAN)(mean)
    for size in (0, 1, 7):
        first, others = rng.normal(), rng.normal(size=size)
        assert by_address(address_of(compiled, MEAN), first, others) == compiled(first, others) + 1.0


def test_an_error_raised_in_a_function_called_by_its_address_arrives(by_address):
    compiled = numba.njit(MEAN)(doubtful)
    where = address_of(compiled, MEAN)
    assert by_address(where, 4.0, np.zeros(1)) == 3.0
    with pytest.raises(ValueError, match="negative"):
        by_address(where, -4.0, np.zeros(1))
    assert by_address(where, 9.0, np.zeros(1)) == 4.0


@pytest.mark.compiled
def test_where_there_is_no_function_the_address_is_zero_and_else_it_stays():
    assert not INTERPRETED
    compiled = numba.njit(MEAN)(mean)
    assert address_of(None, MEAN) == 0
    assert address_of(compiled, MEAN) == address_of(compiled, MEAN) != 0


# -- the cache --------------------------------------------------------------------------------------------------------
CODE = {"code": bytes(range(64))}


def cache_file(folder):
    """What keeps the machine code of a kernel, in a folder of the test's own."""
    return type(kernel.limit_rows._cache._cache_file)(str(folder), "kernel", "stamp")


def damages(content):
    """Every way to cut it short, every byte changed, and other bytes."""
    yield from (content[:size] for size in range(len(content)))
    yield from (content[:i] + bytes([content[i] ^ 1 << i % 8]) + content[i + 1 :] for i in range(len(content)))
    yield bytes(reversed(content))


@pytest.mark.compiled
@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
def test_a_damaged_file_of_the_cache_is_missing_and_written_again_and_the_folder_is_named(tmp_path, caplog, suffix):
    kept = cache_file(tmp_path)
    kept.save("key", CODE)
    (file,) = tmp_path.glob(f"*.{suffix}")
    whole = file.read_bytes()
    for content in damages(whole):
        file.write_bytes(content)
        assert kept.load("key") is None
    assert f"{file}: damaged" in caplog.text
    assert f"delete {cache_base()}" in caplog.text
    kept.save("key", CODE)
    assert kept.load("key") == CODE
    assert file.read_bytes() == whole


@pytest.mark.compiled
def test_a_cache_that_takes_no_kernel_is_said_and_is_no_error(tmp_path, caplog):
    kept = cache_file(tmp_path)
    (tmp_path / "kernel.nbi").mkdir()
    assert kept.load("key") is None
    kept.save("key", CODE)
    assert f"{tmp_path}: takes no kernel: Is a directory" in caplog.text
