"""``python -m farhorizon``."""

import sys

from farhorizon.cli import main

sys.exit(main())
