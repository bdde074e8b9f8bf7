"""What every plant and every detector keeps, as checks that the tests of another package call, too."""
