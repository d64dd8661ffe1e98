"""Browser, server and steps for tests of pages."""
