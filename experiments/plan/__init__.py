"""The planner's page: a session that several browsers look at, and the server in front of it.

``session`` is what is planned, and every way to change it, ``messages`` what browsers may ask for,
``background`` the image below; ``numbers`` says what it achieves; ``desk`` holds it all together;
``worker`` runs what takes long in processes of its own, ``tasks`` is what runs there; ``server``
talks to browsers, and ``page/`` is what it gives them.
"""
