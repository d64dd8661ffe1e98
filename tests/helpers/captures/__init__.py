"""Small captures and their calibrations, and residuals without any capture."""
