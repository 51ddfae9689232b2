"""Make an orchard to plan in: a row of trees grown from a seed, or measured trees, with fruit to reach for."""

import sys
from functools import partial

from hplan.apps.cli.main import run_subcommand

main = partial(run_subcommand, "orchard", "make_orchard.py")

if __name__ == "__main__":
    sys.exit(main())
