"""Independent implementations and captures of known truth that results are held against, by tests and benchmarks.

Tests find the package as ``oracles`` (pytest adds ``tests`` to the path), benchmarks by ``import oracles_path``.
"""
