"""Plan the reference scene, or the one named, and write trajectory, report and page."""

import sys

from hplan.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
