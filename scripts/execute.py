"""Run a trajectory on a simulated arm; report contacts and end."""

import sys
from functools import partial

from hplan.apps.cli.main import run_subcommand

main = partial(run_subcommand, "execute", "execute.py")

if __name__ == "__main__":
    sys.exit(main())
