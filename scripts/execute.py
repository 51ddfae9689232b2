"""Let a simulated arm run a trajectory among the obstacles of a scene, and say what it touched and where it ended."""

import sys

from hplan.cli.execute import main

if __name__ == "__main__":
    sys.exit(main(prog="execute.py"))
