"""What is measured in which order, and the record of having done it."""
