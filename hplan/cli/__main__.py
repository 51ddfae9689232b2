"""`python -m hplan.cli`, the same as `hplan`."""

import sys

from hplan.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
