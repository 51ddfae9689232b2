"""Make an orchard to plan in: a row of trees grown from a seed, or measured trees, with fruit to reach for."""

import sys

from hplan.cli.orchard import main

if __name__ == "__main__":
    sys.exit(main(prog="make_orchard.py"))
