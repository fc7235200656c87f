"""What an owner wants: who may do what, how precisely, and why; written once."""
