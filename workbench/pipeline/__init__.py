"""Stages, planning, freshness, running and records."""
