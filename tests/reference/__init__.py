"""Multiple-precision reference solutions of the contact-space problem, and a stored table of them."""
