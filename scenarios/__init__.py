"""Euro NCAP cases, where they are driven at a junction, and the braking that may help.

``load_cases()`` has all cases, ``pick_cases()`` those that a user names.
``build_runs()`` lays them on the arms of a junction, by the study's own start points
where there are any, else by the rules of the protocol; every run lies on a grid of
frames that ends at the unbraked impact. ``last_brake_time_s()`` says when braking is
too late, ``weigh()`` how much each run counts.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
