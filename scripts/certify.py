"""Judge a trajectory, or the folder of a job."""

import sys

from hplan.cli.certify_command import main

if __name__ == "__main__":
    sys.exit(main(prog="certify.py"))
