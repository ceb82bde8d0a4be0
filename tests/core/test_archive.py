"""Whatever byte of an archive of arrays is hit, it counts as damaged."""

import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.files import NPZ_ERRORS, read_npz


def packed() -> bytes:
    whole = io.BytesIO()
    np.savez_compressed(whole, one=np.arange(7.0), words=np.array(["a", "bc"]))
    return whole.getvalue()


WHOLE = packed()


@settings(max_examples=300, deadline=None)
@given(st.integers(0, len(WHOLE) - 1), st.integers(0, 255))
def test_a_changed_byte_is_damage_or_nothing(at, byte):
    broken = WHOLE[:at] + bytes([byte]) + WHOLE[at + 1 :]
    try:
        found = read_npz(broken)
    except NPZ_ERRORS:
        return
    assert list(found) == ["one", "words"]
    np.testing.assert_array_equal(found["one"], np.arange(7.0))
    assert found["words"].tolist() == ["a", "bc"]


def test_no_array_is_swallowed():
    """The length of a comment, in the list of entries: 32 bytes after where each begins."""
    entry = WHOLE.index(b"PK\x01\x02")
    for at in (entry + 32, entry + 33):
        broken = WHOLE[:at] + bytes([WHOLE[at] ^ 128]) + WHOLE[at + 1 :]
        with pytest.raises(NPZ_ERRORS, match="lists 1 arrays of 2"):
            read_npz(broken)


@pytest.mark.parametrize(
    "header", ["{'descr': '<f8", "{'des\n", "(((", "{'descr': <f8, }", "{'descr': '<f8', 'shape': (2,), }", "", "\x00{"]
)
def test_a_header_that_is_no_literal_is_damage(header):
    encoded = header.encode("latin-1").ljust(54) + b"\n"
    array = b"\x93NUMPY\x01\x00" + len(encoded).to_bytes(2, "little") + encoded + bytes(16)
    with pytest.raises(NPZ_ERRORS):
        np.load(io.BytesIO(array), allow_pickle=False)
