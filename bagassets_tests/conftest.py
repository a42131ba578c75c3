"""The environment of all tests: the same wherever they run.

What somebody has set for other reasons (a locale, a time zone, threads of OpenBLAS, a proxy) changes what
libraries and programs do. So few variables are kept, and a test that depends on one sets it.
"""

import os
import time
from fnmatch import fnmatchcase

# Where programs and files are, the devkit's environment, and what drives the tests.
KEPT = (
    "PATH", "HOME", "TMPDIR", "USER", "LOGNAME", "SHELL", "PYTHONPATH", "LD_LIBRARY_PATH",
    "BAGASSETS_DEVKIT_PYTHON", "PYTEST_*", "HYPOTHESIS_*", "COVERAGE_*", "COV_CORE_*", "MUTA*", "PYTHONDONTWRITEBYTECODE",
)  # fmt: skip
SET = {"LC_ALL": "C.UTF-8", "TZ": "UTC"}


def pytest_configure() -> None:
    """Replace the environment of this process, before a test imports a library that reads it."""
    for name in list(os.environ):
        if not any(fnmatchcase(name, pattern) for pattern in KEPT):
            del os.environ[name]
    os.environ.update(SET)
    time.tzset()
    os.umask(0o022)
