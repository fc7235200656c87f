"""What an owner wants: who may do what and how precisely, written once, decided everywhere alike."""
