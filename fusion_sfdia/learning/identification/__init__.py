"""Models from recordings: a linear plant with its noise, identified from healthy readings."""
