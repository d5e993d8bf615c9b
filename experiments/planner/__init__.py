"""``place-rsus plan``: a program with which people plan by hand, on a page in the browser.

``plan`` has the plan and every way to change it, ``numbers`` its messages to browsers, ``session``
holds it all together, ``tasks`` runs in processes of its own, and ``server`` serves ``page/``.
"""
