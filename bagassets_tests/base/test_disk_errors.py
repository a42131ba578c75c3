import errno
import os

import pytest

from bagassets.base.disk_errors import disk_advice
from bagassets.base.errors import DatasetError, StoreError
from bagassets.base.unexpected import disk_errors_explained
from bagassets.formats.guard import guarded
from bagassets.store.artifact import writing


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.ENOSPC, "free disk space"),
        (errno.EDQUOT, "free disk space"),
        (errno.EIO, "check the disk or file server, and try again"),
        (errno.ESTALE, "check the disk or file server, and try again"),
        (errno.EROFS, "mount its disk for writing, or use another folder"),
        (errno.EACCES, "free disk space, or make the folder writable"),
    ],
)
def test_advice_fits_the_error_wherever_a_write_fails(number, advice, tmp_path):
    err = OSError(number, os.strerror(number))
    assert disk_advice(err) == advice
    end = rf"{os.strerror(number)}\); {advice}\.$".replace(" (", r" \(")
    with pytest.raises(StoreError, match=end), writing(tmp_path):
        raise err
    with pytest.raises(DatasetError, match=end), guarded(tmp_path):
        raise err
    if number != errno.EACCES:  # which an unexpected place does not explain
        with pytest.raises(StoreError, match=end), disk_errors_explained("the page"):
            raise err


def test_what_no_disk_refused_keeps_its_own_advice():
    assert disk_advice(ValueError("no JSON"), "build again") == "build again"
    assert disk_advice(OSError(errno.ENOENT, "gone"), "build again") == "build again"
    assert (
        disk_advice(OSError(errno.EIO, "failed"), "build again")
        == "check the disk or file server, and try again"
    )
