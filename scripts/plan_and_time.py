"""Plan the reference scene, or the one named, and write trajectory, report and page."""

import sys

from hplan.cli.plan import main

if __name__ == "__main__":
    sys.exit(main(prog="plan_and_time.py"))
