"""From samples to a closed surface that knows what was measured."""
