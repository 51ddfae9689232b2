"""Plan a picking tour: many fruits from one start, in the order in which the arm is done soonest."""

import sys
from functools import partial

from hplan.apps.cli.main import run_subcommand

main = partial(run_subcommand, "tour", "plan_tour.py")

if __name__ == "__main__":
    sys.exit(main())
