"""The command: ``python -m cg``."""

import sys

from cg.command import main

if __name__ == "__main__":
    sys.exit(main(program="python -m cg"))
