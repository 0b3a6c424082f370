"""Where photographs were taken from: structure from motion, and its place on the scans."""
