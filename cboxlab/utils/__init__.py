"""What every room uses: errors, complete files, frozen values, input files, progress."""
