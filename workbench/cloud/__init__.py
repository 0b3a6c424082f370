"""The consolidated samples of all scans."""
