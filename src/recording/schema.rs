//! Topics, and the ROS 2 definitions of their messages. Every file contains the definitions, so that other
//! tools can decode it.

/// A topic. The order is that of the ids.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Topic {
    /// Valid poses as a ROS message.
    Pose,
    /// Frames of the stream.
    Frame,
    /// Samples with their raw codes.
    Sample,
    /// Reports that there are no samples.
    Silence,
    /// Changes of the lock state.
    Lock,
    /// Configuration and correction tables.
    Config,
    /// The source.
    Source,
    /// State of the estimation.
    Keyframe,
    /// Reports of entries lost on the way to the file.
    Gap,
}

/// Precedes each definition that another one needs.
const SEPARATOR: &str =
    "================================================================================\nMSG: ";

const HEADER: (&str, &str) = ("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n");
const TIME: (&str, &str) = ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n");
const POSE: [(&str, &str); 6] = [
    HEADER,
    TIME,
    ("geometry_msgs/PoseWithCovariance", "geometry_msgs/Pose pose\nfloat64[36] covariance\n"),
    ("geometry_msgs/Pose", "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"),
    ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
    ("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"),
];

impl Topic {
    /// Every topic.
    pub const ALL: [Topic; 9] = [
        Topic::Pose,
        Topic::Frame,
        Topic::Sample,
        Topic::Silence,
        Topic::Lock,
        Topic::Config,
        Topic::Source,
        Topic::Keyframe,
        Topic::Gap,
    ];

    /// Name: `/trifacet/pose`.
    pub fn name(self) -> &'static str {
        match self {
            Topic::Pose => "/trifacet/pose",
            Topic::Frame => "/trifacet/frame",
            Topic::Sample => "/trifacet/sample",
            Topic::Silence => "/trifacet/silence",
            Topic::Lock => "/trifacet/lock",
            Topic::Config => "/trifacet/config",
            Topic::Source => "/trifacet/source",
            Topic::Keyframe => "/trifacet/keyframe",
            Topic::Gap => "/trifacet/gap",
        }
    }

    /// The topic with this name.
    pub fn of(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }

    /// Type of the messages: `geometry_msgs/msg/PoseWithCovarianceStamped`.
    pub fn schema(self) -> &'static str {
        match self {
            Topic::Pose => "geometry_msgs/msg/PoseWithCovarianceStamped",
            Topic::Frame => "trifacet_msgs/msg/PoseFrame",
            Topic::Sample => "trifacet_msgs/msg/Sample",
            Topic::Silence => "trifacet_msgs/msg/Silence",
            Topic::Lock => "trifacet_msgs/msg/Lock",
            Topic::Config => "trifacet_msgs/msg/Config",
            Topic::Source => "trifacet_msgs/msg/Source",
            Topic::Keyframe => "trifacet_msgs/msg/Keyframe",
            Topic::Gap => "trifacet_msgs/msg/Gap",
        }
    }

    /// Definition of the type, followed by those that it needs.
    pub fn definition(self) -> String {
        let (own, needed) = match self {
            Topic::Pose => {
                ("std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n", POSE.as_slice())
            }
            Topic::Frame => (include_str!("msg/PoseFrame.msg"), [TIME].as_slice()),
            Topic::Sample => (include_str!("msg/Sample.msg"), [TIME].as_slice()),
            Topic::Silence => (include_str!("msg/Silence.msg"), [TIME].as_slice()),
            Topic::Lock => (include_str!("msg/Lock.msg"), [TIME].as_slice()),
            Topic::Config => (include_str!("msg/Config.msg"), [TIME].as_slice()),
            Topic::Source => (include_str!("msg/Source.msg"), [TIME].as_slice()),
            Topic::Keyframe => (include_str!("msg/Keyframe.msg"), [TIME].as_slice()),
            Topic::Gap => (include_str!("msg/Gap.msg"), [TIME].as_slice()),
        };
        needed
            .iter()
            .fold(own.to_owned(), |text, (name, definition)| text + SEPARATOR + name + "\n" + definition)
    }
}
