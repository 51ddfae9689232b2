"""Let a simulated arm run a trajectory among the obstacles of a scene, and say what it touched and where it ended."""

import sys
from functools import partial

from hplan.apps.cli.main import run_subcommand

main = partial(run_subcommand, "execute", "execute.py")

if __name__ == "__main__":
    sys.exit(main())
