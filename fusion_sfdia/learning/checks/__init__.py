"""Checks that every plant and every detector passes, for the tests of this and of other packages."""
