"""One space for what is seen and what two touch sensors feel: two ResNet-50 encoders, aligned by contrast."""
