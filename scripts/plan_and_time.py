"""Plan the reference scene, or the one named, and write trajectory, report and page."""

import sys
from functools import partial

from hplan.apps.cli.main import run_subcommand

main = partial(run_subcommand, "plan", "plan_and_time.py")

if __name__ == "__main__":
    sys.exit(main())
