"""Independent implementations and captures of known truth that results are held against, by tests and benchmarks.

Tests find the package as ``oracles``: pytest adds ``tests`` to the path. Benchmarks add it themselves.
"""
