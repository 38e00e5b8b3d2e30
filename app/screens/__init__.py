"""Textual screens: they show and ask; every number comes from elsewhere."""
