"""Stiff and extreme cases for every method, each with a bound or a refusal it must meet."""
