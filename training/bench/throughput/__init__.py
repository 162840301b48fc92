"""What a vertex and a substep cost, term by term, and whole frames."""
