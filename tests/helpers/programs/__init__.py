"""Commands, installed packages, and suites of other programs."""
