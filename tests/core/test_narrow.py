"""Numbers change their type only if all of them stay the same."""

import re

import numpy as np
import pytest

from vrcaps.core.errors import InputError, narrow


@pytest.mark.parametrize(
    "given", [[0, 255], [0.0, 255.0], np.array([0, 255], np.uint64), [True], []]
)
def test_what_fits_is_kept(given):
    found = narrow(given, np.uint8, "labels")
    assert found.dtype == np.uint8
    assert found.tolist() == np.asarray(given).tolist()


def test_an_array_of_the_type_is_not_copied():
    values = np.arange(3, dtype=np.int16)
    assert narrow(values, np.int16, "numbers") is values


@pytest.mark.parametrize(
    ("given", "dtype", "text"),
    [
        (
            [1, 256, 300],
            np.uint8,
            "2 of the labels are not allowed, the first is 256. Allowed: whole",
        ),
        ([-1], np.uint8, "the first is -1. Allowed: whole numbers from 0 to 255."),
        ([1.6], np.uint8, "the first is 1.6."),
        ([np.nan], np.int16, "the first is nan."),
        ([np.inf, 0.0], np.int16, "the first is inf."),
        ([2.0**63], np.int64, "1 of the labels are not allowed"),
        (np.array([2**63], np.uint64), np.int64, "the first is 9223372036854775808."),
        ([40_000], np.int16, "Allowed: whole numbers from -32768 to 32767."),
        (["a"], np.uint8, "The labels are of type <U1. Give whole numbers."),
        ([1j], np.uint8, "The labels are of type complex128."),
    ],
)
def test_what_does_not_fit_is_counted_and_shown(given, dtype, text):
    with pytest.raises(InputError, match=re.escape(text)):
        narrow(given, dtype, "labels")


@pytest.mark.parametrize("dtype", [np.int64, np.uint64, np.int32])
def test_the_ends_of_a_range_are_exact(dtype):
    limits = np.iinfo(dtype)
    values = np.array([limits.min, limits.max], dtype)
    wide = values.astype(np.uint64 if limits.min == 0 else np.int64)
    assert np.array_equal(narrow(wide, dtype, "numbers"), values)
    assert narrow([float(limits.min)], dtype, "numbers")[0] == limits.min
