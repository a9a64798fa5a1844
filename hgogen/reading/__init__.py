"""Text at the door: expressions by a grammar of their own, library entries, log files, measured records."""
