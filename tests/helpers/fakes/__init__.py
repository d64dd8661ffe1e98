"""Stand-ins for parts of the program, with numbers that are known by hand."""
