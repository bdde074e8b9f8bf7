"""What every room uses: arguments, errors, files, clocks, texts."""
