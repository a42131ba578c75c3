"""One target in this process, with atheris: `python -m bagassets_tests.fuzz.one TARGET [CORPUS …] [-OPTION=VALUE …]`."""

import gc
import logging
import sys

import atheris

with atheris.instrument_imports(include=["bagassets"]):
    from bagassets_tests.fuzz.targets import TARGETS


def main():
    target = TARGETS[sys.argv[1]]
    logging.disable()
    target.run(b"")  # what is made once does not count as time that an input takes
    gc.freeze()
    atheris.Setup([sys.argv[0], *sys.argv[2:]], target.run)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
