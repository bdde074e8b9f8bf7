"""Generation areas joined by tie lines, which are plugged in and out (Boem 2018)."""
