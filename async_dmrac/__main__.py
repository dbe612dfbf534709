"""`python -m async_dmrac`: the `dmrac` command."""

import sys

from async_dmrac.command_line import main

if __name__ == "__main__":
    sys.exit(main())
