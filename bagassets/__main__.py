"""`python -m bagassets` is the command `bagassets`."""

import sys

from bagassets.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
