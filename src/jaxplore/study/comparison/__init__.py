"""The exploration benchmark: explorers on maps with seeds, over processes or machines."""
