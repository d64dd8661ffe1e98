"""A user's package: one effect for every stage, none of which the catalogue holds. The tests install it."""
