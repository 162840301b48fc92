"""A dancing figure: joints that move (``motion``, ``dance``) and the capsules around them (``body``)."""
