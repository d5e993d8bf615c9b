"""Tags of OpenStreetMap as its users write them."""


def tags_of(*texts):
    """Tags of texts such as "lanes=3; width=9": keys and values; of "" none."""
    tags = {}
    for text in filter(None, texts):
        tags |= dict(tag.split("=") for tag in text.split("; "))
    return tags
