"""``python -m adaptrack``: the command line."""

import sys

from adaptrack.cli import main

if __name__ == "__main__":
    sys.exit(main())
