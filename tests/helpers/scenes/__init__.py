"""Small boxes and scene files, recipes of data sets, rays."""
