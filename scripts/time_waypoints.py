"""Time a motion through waypoints for any robot that Pinocchio reads, and write it for the controller."""

import sys

from hplan.cli.time import main

if __name__ == "__main__":
    sys.exit(main(prog="time_waypoints.py"))
