"""The papers' experiments as scenarios, one file each, and measurements of speed."""
