"""Errors that callers tell apart."""


class NotApplicableError(ValueError):
    """A detector on a plant that lacks what its method needs: scalar equations, noise bounds, enough sensors."""


class MissingPackageError(NotApplicableError, ModuleNotFoundError):
    """Something that needs a package which is not installed; the message names the extra to install."""
