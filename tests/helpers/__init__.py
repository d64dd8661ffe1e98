"""What several tests build: boxes, captures, stages, and the ways to run commands, browsers and other suites."""
