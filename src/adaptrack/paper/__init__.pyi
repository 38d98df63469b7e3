"""The public names of the paper's experiment."""

from .adaptation import adapt as adapt
from .anfis import ANFIS as ANFIS
from .campaign import run_campaign as run_campaign
from .campaign_config import (
    CampaignConfig as CampaignConfig,
    list_campaigns as list_campaigns,
    load_campaign as load_campaign,
)
from .data_set import DataSet as DataSet, list_datasets as list_datasets, load_dataset as load_dataset
from .data_set import describe as describe
from .anfis import write_fis as write_fis
from .improvement import improve as improve
from .mlp import MLP as MLP
from .anfis import subtractive_clustering as subtractive_clustering
from .training import trained_schedule as trained_schedule
from .training import TARGET_SLOTS as TARGET_SLOTS, Trained as Trained, train as train
