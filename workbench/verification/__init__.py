"""Numbers, pictures and pages that show how good a model is."""
