"""The consolidated samples of all scans, in memory or larger than it."""
