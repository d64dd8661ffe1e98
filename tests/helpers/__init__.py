"""What several tests use: scenes, captures, files, pages, programs, and stand-ins of results (`fakes`)."""
