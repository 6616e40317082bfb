"""Reference answers to the contact-space problem in multiple precision, and the stored table of them."""
