"""What a worker has to import although its server imported so much."""

import sys

from bagassets.defs.launchers.run_worker import execute


def of_a_run(args):
    before = set(sys.modules)
    execute({**args, "locks": args["instance"]})
    return sorted(set(sys.modules) - before)
