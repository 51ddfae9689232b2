"""Time a motion through waypoints for any robot that Pinocchio reads, and write it for the controller."""

import sys
from functools import partial

from hplan.apps.cli.main import run_subcommand

main = partial(run_subcommand, "time", "time_waypoints.py")

if __name__ == "__main__":
    sys.exit(main())
