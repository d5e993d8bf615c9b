"""``place-rsus plan``: a program with which people plan by hand, on a page in the browser.

A browser sends a request, :class:`.session.Session` makes another
:class:`.workspace.Shown` of it, and tells all browsers. Two loops follow each change:
one counts at once by the detection table, the other asks the evaluator when the plan
rests.

The plan, as pure values
    ``plan``: variants, undo and redo. ``requests``: what browsers can ask for.
    ``changes``: the plan after a request. ``poles``: poles of one's own.
    ``background``: the image below the plan; ``aerial_images`` cuts it out of a raster.
    ``plan_files``: plans as files.

What is known of it
    ``workspace``: a scene with the numbers known so far, and what is shown of it at one
    moment. ``numbers``: the parts of messages to browsers. ``counting``: the two loops.
    ``views``: what units see. ``proposals``: the optimiser's answers.

Work that takes long
    ``tasks``: what can be done. ``worker``: a process that does it and can be ended.
    ``workers``: the processes of a session. ``opening``: another question, or another
    scene, that is to come while the old one is shown.

The session and its browsers
    ``session``: what each request leads to. ``browsers``: who listens, and the messages
    that greet a new browser. ``files``: where plans are saved, and maps that were sent.

The program
    ``command``: the command line. ``server``: addresses, who may ask, how it ends.
    ``page_files``: what browsers load, of ``page/``. ``tiles``: a map behind the plan.
"""
