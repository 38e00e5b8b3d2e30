"""Sentences and tables that people read; commands and screens share them."""
