"""The pages of the person who lives with the robots. Reserved: nothing is here yet."""
