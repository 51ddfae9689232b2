"""Plan a picking tour: many fruits from one start, in the order in which the arm is done soonest."""

import sys

from hplan.cli.tour import main

if __name__ == "__main__":
    sys.exit(main(prog="plan_tour.py"))
