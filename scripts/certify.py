"""Certify a trajectory, or the result of a job in its folder."""

import sys
from functools import partial

from hplan.apps.cli.main import run_subcommand

main = partial(run_subcommand, "certify", "certify.py")

if __name__ == "__main__":
    sys.exit(main())
