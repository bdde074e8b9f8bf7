"""Errors that callers tell apart."""


class NotApplicableError(ValueError):
    """A detector on a plant that lacks what its method needs: scalar equations, noise bounds, enough sensors.

    Examples
    --------
    >>> from fusion_sfdia import NotApplicableError, Sensor, detector, linear_plant
    >>> plant = linear_plant("tank", [[0.97]], [[1.0]], [Sensor("gauge", "x0", sigma=0.01)], dt=60.0, x0=[0.0],
    ...                      initial_cov=[1e-4], process_cov=[1e-6])
    >>> try:
    ...     detector("adaptive-threshold", plant)
    ... except NotApplicableError as error:
    ...     print("not applicable")
    <Diagnoser adaptive-threshold on tank>
    """


class MissingPackageError(NotApplicableError, ModuleNotFoundError):
    """Something that needs a package which is not installed; the message names the extra to install.

    Examples
    --------
    >>> from fusion_sfdia import MissingPackageError, NotApplicableError
    >>> issubclass(MissingPackageError, NotApplicableError)
    True
    """
