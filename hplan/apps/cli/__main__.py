"""Entry point of `python -m hplan.apps.cli`; equivalent to `hplan`."""

import sys

from hplan.apps.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
