"""Damaged arrays, which are not trusted."""

import io
import zipfile

import numpy as np
import pytest

from jaxplore.maps.files.npz import read_arrays


def packed(header: str) -> bytes:
    text = header.encode().ljust(117) + b"\n"
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text)
    return file.getvalue()


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f4', 'fortran_order': False, 'shape': (3",
        "{'descr': '<f4', 'fortran_order': False, 'shape': '''",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (3L,), }}}",
        "(" * 100,
        "",
    ],
)
def test_a_damaged_header_is_a_value_error(header: str) -> None:
    with pytest.raises(ValueError, match="a has a damaged header"):
        read_arrays(packed(header), lambda *_: None)


def test_a_whole_file_is_read() -> None:
    file = io.BytesIO()
    np.savez(file, a=np.arange(3.0), b=np.eye(2, dtype=bool))
    found = read_arrays(file.getvalue(), lambda *_: None)
    np.testing.assert_array_equal(found["a"], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(found["b"], np.eye(2, dtype=bool))
