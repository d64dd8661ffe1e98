"""Common parts of all rooms: errors, complete files, frozen values, input files, progress."""
