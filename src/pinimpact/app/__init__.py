"""The command line, its reports, and scene files."""
