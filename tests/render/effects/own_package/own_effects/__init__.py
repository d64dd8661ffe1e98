"""A user's package: one effect for every stage that is not in the catalogue. The tests install it."""
