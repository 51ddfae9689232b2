"""Certify a trajectory, or what a job left in its folder."""

import sys

from hplan.cli.certify import main

if __name__ == "__main__":
    sys.exit(main(prog="certify.py"))
